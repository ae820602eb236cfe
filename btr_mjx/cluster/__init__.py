"""Evaluation of many pairs in blocks: saved as they are done, resumed after a kill, on one process or a Dask cluster.

`evaluate_blocks` evaluates all pairs of (simulations, controllers) block by block; `iterate_blocks` yields the blocks,
for tables that no memory holds. `connect` reaches a cluster by the text of --cluster, and `map_cases` maps any function
over cases on it. Dask is needed only where a cluster is named (pip install "btr-mjx[cluster]").

Names load on first use (`__init__.pyi` lists them): a scheduler, which loads tasks, does not load JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
