"""Writes table.parquet, a typical lab table with pandas' missing values, a nested column and snappy compression.

Usage: python table.py   (packages: ../requirements.txt)
"""

import pyarrow as pa
import pyarrow.parquet

table = pa.table(
    {
        "success": pa.array([True, False, None, True, False]),
        "failure_mode": pa.array([None, "grip_loss", None, None, "timeout"]),
        "cycle_time_s": pa.array([6.5, 4.25, None, 7.0, 15.0]),
        "error": pa.array([None, None, "simulator crashed", None, None]),
        "mass_kg": pa.array([0.25, 1.5, 0.5, 0.75, 2.0], pa.float32()),
        "obstacles": pa.array([0, 1, 2, 3, 1], pa.int32()),
        "shape": pa.array(["box", "sphere", "box", "box", "cylinder"]).dictionary_encode(),
        "trace": pa.array([[1.0], [2.0, 3.0], [], None, [4.0]]),
    }
)
pyarrow.parquet.write_table(table, "table.parquet", compression="snappy")
