from .blocks import BlockSettings, PairBlock, PairTable, evaluate_blocks, iterate_blocks
from .connection import check_cluster, connect
from .mapping import map_cases

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
