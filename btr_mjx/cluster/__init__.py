"""Evaluation of many pairs in blocks: saved as they are done, resumed after a kill, on one process or a Dask cluster.

`evaluate_blocks` evaluates all pairs of (simulations, controllers) block by block; `iterate_blocks` yields the blocks,
for tables that no memory holds. `connect` reaches a cluster by the text of --cluster, and `map_cases` maps any function
over cases on it. Dask is needed only where a cluster is named (pip install "btr-mjx[cluster]").
"""

from btr_mjx.cluster.blocks import BlockSettings, PairBlock, PairTable, evaluate_blocks, iterate_blocks
from btr_mjx.cluster.connection import check_cluster, connect
from btr_mjx.cluster.mapping import map_cases

__all__ = [
    "BlockSettings",
    "PairBlock",
    "PairTable",
    "check_cluster",
    "connect",
    "evaluate_blocks",
    "iterate_blocks",
    "map_cases",
]
