"""Signs of joints that the data cannot tell, where a format has no convention of signs (LeRobot).

A servo whose goals and positions both count the other way round follows them as well. Only gravity and other joints can
show it, and only if the believed servo gives way to them.
"""

from btr_mjx.gap.data import Dataset, Noise
from btr_mjx.gap.preflight.alternatives.catalogue import Catalogue
from btr_mjx.gap.preflight.comparison import compare
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.predictions import Change, Predictor, typical_error
from btr_mjx.models import part_names

_STRETCHES = 32


def undecided_signs(dataset: Dataset, noise: Noise) -> list[Finding]:
    """A note that names the joints whose sign cannot be told, and where it is declared; of LeRobot datasets only.

    It has no lines to write: they would turn joints that may be right.
    """
    if not dataset.scales:
        return []
    predictor, names = Predictor(dataset, noise, _STRETCHES), part_names(dataset.model, "joint")
    turned = Catalogue(dataset, predictor.groups).turned()
    told = set[str]()
    if len(predictor):
        now, *others = predictor.errors([Change.none(dataset.model), *turned.values()])
        every = range(now.shape[1])
        told = {
            names[joint]
            for joint, errors in zip(turned, others, strict=True)
            if compare(typical_error(errors, every), typical_error(now, every)).significant
        }
    unknown = [name for name in dataset.scales if name not in told]
    as_modelled = f"signs of {', '.join(told)} fit the model; " if told else ""
    those = f"signs of {', '.join(unknown)}, and zeros of all joints," if unknown else "zeros"
    scale = dataset.scales[(unknown or list(dataset.scales))[0]]
    return [
        Finding(
            "note",
            "sign",
            f"{as_modelled}{those} cannot be told from these data: LeRobot's calibration is taken to be that of the "
            "model. Who knows that a joint counts the other way round, or that the model's 0 is another pose, says so "
            f"with sign and {scale.zero_key} below {scale.heading} in dataset.toml",
        )
    ]
