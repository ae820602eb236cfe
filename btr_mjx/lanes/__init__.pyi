from .coverage import Coverage, CoveredPair, coverage
from .rollouts import LanesRollout, rollout

__all__ = ["Coverage", "CoveredPair", "LanesRollout", "coverage", "rollout"]
