"""Writes the Parquet files of this folder: `pip install pyarrow && python make.py` (pyarrow 26.0.1 wrote those that are here)."""

import pyarrow as pa
import pyarrow.parquet as pq

START_NS = 1_700_000_000_123_456_789

table = pa.table(
    {
        "stamp": pa.array([START_NS + i * 10_000_000 for i in range(4)], pa.timestamp("ns")),
        "curl_deg": pa.array([0.0, 0.1, None, -2.5e-7], pa.float64()),
        "slide": pa.array([0.05, 0.1, 0.2, 0.3], pa.float32()),
        "tip.0": pa.array([200, None, 65535, 7], pa.uint16()),
        "tip.1": pa.array([-1, 2, 3, 4], pa.int64()),
        "on": pa.array([True, False, None, True]),
        'a "b", c': pa.array(["x", "y", None, "z"]),
        "seen": pa.array([1, 2, 3, 4], pa.timestamp("ms")),
        "list": pa.array([[1.0], [], None, [2.0, 3.0]]),
    }
)
# Snappy, dictionaries and pages of version 1, as pandas and pyarrow write them.
pq.write_table(table, "snappy.parquet")
pq.write_table(
    table, "zstd.parquet", compression="zstd", data_page_version="2.0", use_dictionary=False, row_group_size=3
)
