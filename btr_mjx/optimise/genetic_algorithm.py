"""Generational genetic algorithm on bit strings, with an ask / tell interface.

Both searches of Back-to-Reality use it: for controllers in a simulation (fitness is maximised) and for simulations
(Delta_fitness is minimised). Parents are selected by tournament, crossed over and mutated with "probability p_m per
bit"; the best few members (elites) survive unchanged.

    ga = GeneticAlgorithm(box, GAConfig(maximise=False))
    state = ga.init(seed)
    for _ in range(generations):
        genomes, state = ga.ask(state)
        state = ga.tell(state, genomes, f(box.decode(genomes)))
    best = box.decode(state.best_genome)

A state is an immutable record of arrays that includes the state of the random generator: a run continued from
`ga_state_from_arrays` is bit-identical to an uninterrupted run, and `ask` returns the same genomes for the same state.

Failed evaluations: a member whose fitness is NaN or infinite never becomes best, parent or elite as long as any member
of the population is finite. A generation in which all members fail counts as a generation but leaves parents and best
unchanged; if it is the first one, all members of the initial population are equally likely parents of the next.

The defaults suit about four parameters of smooth or mildly rugged functions, or more that do not interact. For many
parameters that interact strongly use CMA-ES. For long genomes and many generations p_m = 1 / n_bits is more accurate.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from btr_mjx.errors import InputError
from btr_mjx.optimise.operators import Crossover, check_probability, crossover, mutate
from btr_mjx.robots import Box

Seed = int | np.random.Generator
"""An integer, or a generator from which a seed is drawn (which advances the generator)."""


def _frozen(array: ArrayLike, dtype: Any = None) -> NDArray:
    """A read-only copy: states are shared between the caller and later generations."""
    copy = np.array(array, dtype=dtype)
    copy.flags.writeable = False
    return copy


@dataclass(frozen=True, kw_only=True)
class GAConfig:
    """Settings of the genetic algorithm.

    Attributes:
      maximise: whether fitness is maximised or minimised.
      population: M, genomes per generation.
      p_m: mutation probability per bit, also for the first generation made from a given genome.
      p_c: probability of crossover of a pair of parents.
      crossover: see `Crossover`.
      elites: members that enter the next generation unchanged (and are evaluated again).
      tournament: members per tournament, drawn with replacement; 1 selects at random.
    """

    maximise: bool
    population: int = 50
    p_m: float = 0.02
    p_c: float = 0.9
    crossover: Crossover = "uniform"
    elites: int = 2
    tournament: int = 5

    def __post_init__(self):
        """Check the ranges."""
        if not isinstance(self.maximise, bool):
            raise InputError(f"maximise: got {self.maximise!r}, expected True or False")
        check_probability("p_m", self.p_m)
        check_probability("p_c", self.p_c)
        if self.crossover not in get_args(Crossover):
            kinds = ", ".join(map(repr, get_args(Crossover)))
            raise InputError(f"crossover: got {self.crossover!r}, expected one of {kinds}")
        for name, least in (("population", 2), ("elites", 0), ("tournament", 1)):
            value = getattr(self, name)
            if not isinstance(value, (int, np.integer)) or value < least:
                raise InputError(f"{name}: got {value!r}, expected a whole number, {least} or more")
        if self.elites >= self.population:
            raise InputError(
                f"elites: got {self.elites}, expected fewer than the population of {self.population}; "
                "otherwise nothing new would ever be tried"
            )


@dataclass(frozen=True, eq=False)
class GAState:
    """State of a run; read-only arrays.

    Attributes:
      parents: (M, n_bits) the last evaluated population, best first, failed members last; at first the initial one.
      fitness: (M,) fitness of the parents, NaN where it failed or is not known yet.
      asked: (M, n_bits) genomes that await their fitness, or None.
      generation: number of generations told.
      best_genome: (n_bits,) the best genome so far, or None while there is no finite fitness.
      best_fitness: its fitness, NaN while there is none.
      stream: (6,) uint64, state of the PCG64 random generator.
    """

    parents: NDArray[np.bool_]
    fitness: NDArray[np.float64]
    asked: NDArray[np.bool_] | None
    generation: int
    best_genome: NDArray[np.bool_] | None
    best_fitness: float
    stream: NDArray[np.uint64]


def _stream_of(rng: np.random.Generator) -> NDArray[np.uint64]:
    whole: Any = rng.bit_generator.state
    words = [whole["state"][part] >> shift & (2**64 - 1) for part in ("state", "inc") for shift in (64, 0)]
    return _frozen([*words, whole["has_uint32"], whole["uinteger"]], np.uint64)


def _generator_of(stream: NDArray[np.uint64]) -> np.random.Generator:
    high, low, inc_high, inc_low, has_uint32, uinteger = (int(word) for word in stream)
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": high << 64 | low, "inc": inc_high << 64 | inc_low},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return np.random.Generator(bits)


def ga_state_to_arrays(state: GAState) -> dict[str, np.ndarray]:
    """A state as plain arrays, for `numpy.savez`; None becomes an array without rows."""
    n_bits = state.parents.shape[1]
    none = np.zeros((0, n_bits), dtype=bool)
    return {
        "parents": np.array(state.parents),
        "fitness": np.array(state.fitness),
        "asked": none if state.asked is None else np.array(state.asked),
        "generation": np.array(state.generation, dtype=np.int64),
        "best_genome": none if state.best_genome is None else state.best_genome[None].copy(),
        "best_fitness": np.array(state.best_fitness, dtype=np.float64),
        "stream": np.array(state.stream),
    }


def ga_state_from_arrays(arrays: Mapping[str, np.ndarray]) -> GAState:
    """The state from the arrays of `ga_state_to_arrays`, such as an open npz file.

    Raises:
      InputError: arrays missing, or of the wrong type or shape.
    """
    missing = [field.name for field in fields(GAState) if field.name not in arrays]
    if missing:
        raise InputError(f"GA state: got no {', '.join(missing)}, expected what ga_state_to_arrays writes")
    get = {field.name: np.asarray(arrays[field.name]) for field in fields(GAState)}
    m, n_bits = get["parents"].shape if get["parents"].ndim == 2 else (-1, -1)
    expected: dict[str, tuple[type, list[tuple[int, ...]]]] = {
        "parents": (np.bool_, [(m, n_bits)]),
        "fitness": (np.float64, [(m,)]),
        "asked": (np.bool_, [(m, n_bits), (0, n_bits)]),
        "generation": (np.int64, [()]),
        "best_genome": (np.bool_, [(1, n_bits), (0, n_bits)]),
        "best_fitness": (np.float64, [()]),
        "stream": (np.uint64, [(6,)]),
    }
    for name, (dtype, shapes) in expected.items():
        if get[name].dtype != dtype or get[name].shape not in shapes:
            raise InputError(
                f"GA state: got {name} of type {get[name].dtype} and shape {get[name].shape}, expected "
                f"{dtype.__name__} and {' or '.join(map(str, shapes))}; the file is not a GA state or was altered"
            )
    return GAState(
        parents=_frozen(get["parents"]),
        fitness=_frozen(get["fitness"]),
        asked=_frozen(get["asked"]) if len(get["asked"]) else None,
        generation=int(get["generation"]),
        best_genome=_frozen(get["best_genome"][0]) if len(get["best_genome"]) else None,
        best_fitness=float(get["best_fitness"]),
        stream=_frozen(get["stream"]),
    )


class GeneticAlgorithm:
    """Genetic algorithm of a box, without state of its own: see the module's docstring."""

    def __init__(self, box: Box, config: GAConfig):
        self.box = box
        self.config = config

    def init(self, seed: Seed, genome: ArrayLike | None = None) -> GAState:
        """Make the initial population.

        Args:
          seed: an integer or a generator.
          genome: (n_bits,) or None. None draws genomes at random; otherwise member 0 is this genome and the others are
            its mutants ("made from c_(i-1) by bit flips with p_m").

        Returns:
          The state before the first `ask`.

        Raises:
          InputError: a genome of the wrong length.
        """
        # A new generator: a copy of the caller's would repeat the numbers that the caller draws next.
        source = seed.integers(2**63, size=2).tolist() if isinstance(seed, np.random.Generator) else seed
        rng = np.random.Generator(np.random.PCG64(source))
        m = self.config.population
        if genome is None:
            population = self.box.random_genomes(rng, m)
        else:
            start = self.box.validate_genomes(genome, "genome")
            if start.ndim != 1:
                raise InputError(f"genome: got shape {start.shape}, expected ({self.box.n_bits},): one genome")
            population = mutate(np.tile(start, (m, 1)), self.config.p_m, rng)
            population[0] = start
        return GAState(_frozen(population), _frozen(np.full(m, np.nan)), None, 0, None, np.nan, _stream_of(rng))

    def ask(self, state: GAState) -> tuple[NDArray[np.bool_], GAState]:
        """The next generation: at first the initial population, then children followed by the elites.

        Elites come last, so that `tell` ranks new members before elites of equal fitness (neutral drift on plateaus). A
        state that was asked already gives the same genomes again.

        Returns:
          (M, n_bits) read-only genomes, and the state to give to `tell`.
        """
        self._check(state)
        if state.asked is not None:
            return state.asked, state
        if state.generation == 0:
            return state.parents, replace(state, asked=state.parents)
        config, rng = self.config, _generator_of(state.stream)
        finite = int(np.isfinite(state.fitness).sum())
        elites = min(config.elites, finite)
        children = config.population - elites
        # Parents are sorted by rank: the winner of a tournament is its lowest index. Failed members do not take part.
        candidates = finite or config.population
        draws = rng.integers(0, candidates, (2, children, config.tournament if finite else 1))
        first, second = state.parents[draws.min(axis=-1)]
        made = mutate(crossover(first, second, config.p_c, config.crossover, rng), config.p_m, rng)
        asked = _frozen(np.concatenate([made, state.parents[:elites]]))
        return asked, replace(state, asked=asked, stream=_stream_of(rng))

    def tell(self, state: GAState, genomes: ArrayLike, fitness: ArrayLike) -> GAState:
        """Update the state with the fitness of a generation.

        Args:
          state: as returned by `ask`.
          genomes: (M, n_bits) the evaluated genomes, usually those of `ask`; repaired genomes may replace them.
          fitness: (M,) NaN or infinite where the evaluation failed.

        Returns:
          The state for the next `ask`.

        Raises:
          InputError: tell before ask; genomes or fitness of the wrong shape or type.
        """
        self._check(state)
        if state.asked is None:
            raise InputError("tell: got a state with no genomes asked, expected the state that ask returned; call ask")
        told = self.box.validate_genomes(genomes)
        if told.shape != state.asked.shape:
            raise InputError(f"tell: got genomes of shape {told.shape}, expected {state.asked.shape} as asked")
        try:
            value = np.asarray(fitness, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"tell: got fitness {fitness!r}, expected real numbers ({error})") from None
        if value.shape != told.shape[:1]:
            raise InputError(f"tell: got fitness of shape {value.shape}, expected {told.shape[:1]}: one per genome")
        value = np.where(np.isfinite(value), value, np.nan)
        state = replace(state, asked=None, generation=state.generation + 1)
        if np.isnan(value).all():
            return state
        sign = -1.0 if self.config.maximise else 1.0
        order = np.argsort(sign * value, kind="stable")  # NaN sorts last
        state = replace(state, parents=_frozen(told[order]), fitness=_frozen(value[order]))
        if state.best_genome is None or sign * value[order[0]] < sign * state.best_fitness:
            state = replace(state, best_genome=_frozen(told[order[0]]), best_fitness=float(value[order[0]]))
        return state

    def _check(self, state: GAState) -> None:
        expected = (self.config.population, self.box.n_bits)
        if state.parents.shape != expected:
            raise InputError(
                f"state: got a population of shape {state.parents.shape}, expected {expected}; it belongs to another "
                "configuration or box"
            )
