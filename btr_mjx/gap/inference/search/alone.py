"""Whether one more effect says anything that the first one's number does not.

Where a first effect's number is a little off, and its neighbourhood a bad one to come from, what is tried beside it
may lead that number to a better place and take the credit for it: a limit of all motors that was 4 % too high had a
second limit at one of them.
"""

from dataclasses import replace

from btr_mjx.gap.inference.scoring.refine import AGAIN
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged


def alone(bench: Bench, both: Judged) -> tuple[Judged, Judged]:
    """Judge what comes before the last effect again, from the numbers that it has beside that one.

    Args:
      bench: of the search.
      both: effects, one more than what was found before.

    Returns:
      All but the last of them, with numbers refined from where they are beside it and the starting states that suit
      both; and both of them, held against that.
    """
    fewer = replace(both.hypothesis, effects=both.hypothesis.effects[:-1])
    fit, test = (side.based(fewer) for side in both.sides)
    count = AGAIN[fewer.effects[-1][0].name in bench.delicate]
    found = bench.refined(fit, [(fewer, [fewer.values(bench.joint)])], [count], both.references[0])
    fewer = fewer.replaced(found[0].values, bench.joint)
    first = bench.judge([fewer], found, (fit, test), both.references)[0]
    again = bench.judge([both.hypothesis], [both.refined], both.sides, both.references, first)[0]
    return first, again
