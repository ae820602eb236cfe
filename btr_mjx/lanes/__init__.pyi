from .coverage import Coverage, coverage
from .rollouts import LanesRollout, rollout

__all__ = ["Coverage", "LanesRollout", "coverage", "rollout"]
