"""Reads a dictionary with pyarrow, pandas and DuckDB, and compares all three with its CSV export.

Usage: readers.py DICTIONARY.parquet EXPORT.csv DATASET_HASH
"""

import csv
import json
import math
import sys

import duckdb
import pandas
import pyarrow.parquet

path, export, dataset_hash = sys.argv[1:]

with open(export, newline="", encoding="utf-8") as file:
    rows = list(csv.reader(file))
names, rows = rows[0], rows[1:]

table = pyarrow.parquet.read_table(path)
metadata = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
assert metadata["robogate.schema_version"] == "4.0", metadata
assert metadata["robogate.dataset_hash"] == dataset_hash
provenance = json.loads(metadata["robogate.provenance"])
assert provenance["robot"]["name"] == "franka", provenance
assert table.column_names == names
types = {field.name: str(field.type) for field in table.schema}
assert types["index"] == types["seed"] == types["ticks"] == "uint64", types
assert types["obstacles"] == types["applied_obstacles"] == "int64", types
assert types["mass_kg"] == types["cycle_time_s"] == types["weight"] == "double", types
assert types["outcome"] == types["shape"] == types["trajectory_hash"] == "string", types
assert not table.schema.field("outcome").nullable and table.schema.field("depth_m").nullable


def same(value, text):
    """Compares a value from a reader with a field of the CSV."""
    if value is None or (isinstance(value, float) and math.isnan(value)) or value is pandas.NA:
        return text == ""
    if isinstance(value, str):
        return value == text
    if isinstance(value, float):
        return text != "" and float(text) == value
    return text != "" and int(float(text)) == int(value)


def compare(reader, columns):
    """Compares every value of every column with the CSV."""
    for at, name in enumerate(names):
        values = columns[name]
        assert len(values) == len(rows), (reader, name, len(values), len(rows))
        for i, value in enumerate(values):
            assert same(value, rows[i][at]), (reader, name, i, value, rows[i][at])
    print(f"{reader}: {len(rows)} rows of {len(names)} columns as written")


compare(f"pyarrow {pyarrow.__version__}", {name: table[name].to_pylist() for name in names})

frame = pandas.read_parquet(path)
compare(f"pandas {pandas.__version__}", {name: frame[name].tolist() for name in names})
rate = (frame["outcome"] == "success").mean()

query = duckdb.sql(f"select * from read_parquet('{path}') order by index")
columns = [description[0] for description in query.description]
fetched = query.fetchall()
compare(f"duckdb {duckdb.__version__}", {name: [row[columns.index(name)] for row in fetched] for name in names})
found = duckdb.sql(f"select avg((outcome = 'success')::int) from read_parquet('{path}')").fetchall()[0][0]
assert abs(found - rate) < 1e-12, (found, rate)
