"""Writes table.parquet, a typical lab table with pandas' missing values, a nested column and snappy compression, and a table
with missing parameters and results in zstd pages of both versions, and a table with texts that repeat their starts (DELTA_BYTE_ARRAY), in pages of both versions.

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

gaps = pa.table(
    {
        "success": pa.array([True, False, True, True, False]),
        "mass_kg": pa.array([0.25, 1.5, None, 0.75, 2.0]),
        "shape": pa.array(["box", "sphere", None, "box", "cylinder"]),
        "return": pa.array([1.0, 0.1, 0.9, 1.0, 0.0]),
        "episode_length": pa.array([31, 200, 40, 33, 200], pa.int32()),
    }
)
pyarrow.parquet.write_table(gaps, "zstd.parquet", compression="zstd")
pyarrow.parquet.write_table(gaps, "zstd_v2.parquet", compression="zstd", data_page_version="2.0")

texts = pa.table(
    {
        "success": pa.array([i % 3 != 0 for i in range(300)]),
        "mass_kg": pa.array([0.25 + 0.01 * i for i in range(300)]),
        "shape": pa.array([f"box with {i % 7} holes" for i in range(300)]),
    }
)
for name, version in [("delta_texts.parquet", "1.0"), ("delta_texts_v2.parquet", "2.0")]:
    pyarrow.parquet.write_table(
        texts, name, use_dictionary=False, column_encoding={"shape": "DELTA_BYTE_ARRAY"}, data_page_version=version
    )
