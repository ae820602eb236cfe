"""CMA-ES with nothing to remember but what was told."""

import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.optimise import cma_es as cma


def oblique(x: np.ndarray) -> np.ndarray:
    """A valley that runs across the parameters; its floor falls towards (0.3, 0.4, ...)."""
    away = x - np.linspace(0.3, 0.7, x.shape[-1])
    along = away.mean(axis=-1, keepdims=True)
    return np.sqrt((along[..., 0] * 0.1) ** 2 + ((away - along) ** 2).sum(axis=-1))


def search(n: int, generations: int, forget: bool) -> tuple[np.ndarray, np.ndarray]:
    """All members and scores; a forgetful search keeps nothing but these between two generations."""
    members, scores = np.zeros((0, 12, n)), np.zeros((0, 12))
    start = np.full(n, 0.8)
    strategy = cma.restored(start, members, scores, population=12)
    for generation in range(generations):
        if forget:
            strategy = cma.restored(start, members, scores, population=12)
        asked = cma.ask(strategy, [5, generation])
        value = oblique(asked)
        value[3] = np.nan
        cma.tell(strategy, asked, value)
        members, scores = np.concatenate([members, asked[None]]), np.concatenate([scores, value[None]])
    return members, scores


def test_a_restored_strategy_goes_on_to_the_bit() -> None:
    for whole, restored in zip(search(4, 25, False), search(4, 25, True), strict=True):
        np.testing.assert_array_equal(whole, restored)


def test_it_finds_the_end_of_an_oblique_valley() -> None:
    members, scores = search(6, 150, False)
    best = members.reshape(-1, 6)[np.nanargmin(scores)]
    np.testing.assert_allclose(best, np.linspace(0.3, 0.7, 6), atol=2e-3)
    assert not cma.converged(members[0])
    assert cma.converged(np.tile(best, (12, 1)) + 1e-6 * np.arange(12)[:, None])
    assert ((members >= 0) & (members <= 1)).all()


def test_a_generation_in_which_all_fail_is_survived() -> None:
    strategy = cma.restored(np.full(3, 0.5), np.zeros((0, 8, 3)), np.zeros((0, 8)), population=8)
    cma.tell(strategy, cma.ask(strategy, 1), np.full(8, np.nan))
    assert np.isfinite(cma.ask(strategy, 2)).all()


@pytest.mark.parametrize(
    ("start", "population", "sigma", "words"),
    [([1.2, 0.5], 8, 0.1, "1.2"), ([0.5, 0.5], 3, 0.1, "at least 4"), ([0.5, 0.5], 8, 0.0, "sigma 0.0")],
)
def test_bad_input(start: list[float], population: int, sigma: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        cma.restored(np.array(start), np.zeros((0, 8, 2)), np.zeros((0, 8)), population=population, sigma=sigma)
