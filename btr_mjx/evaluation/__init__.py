"""Evaluation of pairs (s, c): behaviour and fitness, on which everything else is built.

`evaluate` maps (L, n_s) simulations and (M, n_c) controllers to an `Evaluation` with fitness (L, M). `pair_fitness` is
a function of one pair for JAX. Fitness functions, delta_k, Delta_fitness, distances and `metrics` belong here, too.

Names load on first use (`__init__.pyi` lists them): a fitness function does not load JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
