"""All predicates by the names that a task's goal calls them by. A new one is a module here, and a line in the table."""

from __future__ import annotations

from collections.abc import Mapping

from .above import Above
from .base import Predicate as Predicate
from .folded import Folded
from .handed_over import HandedOver
from .held_by import HeldBy
from .hung import Hung
from .inside import Inside
from .near import Near
from .on import On
from .open import Open
from .over import Over
from .piled import Piled
from .sorted import Sorted
from .spread import Spread
from .stacked import Stacked
from .swapped import Swapped
from .upright import Upright
from .was_handed_over import WasHandedOver

PREDICATES: Mapping[str, type[Predicate]] = {
    "on": On,
    "in": Inside,
    "stacked": Stacked,
    "over": Over,
    "piled": Piled,
    "upright": Upright,
    "near": Near,
    "above": Above,
    "held_by": HeldBy,
    "handed_over": HandedOver,
    "was_handed_over": WasHandedOver,
    "sorted": Sorted,
    "open": Open,
    "swapped": Swapped,
    "hung": Hung,
    "folded": Folded,
    "spread": Spread,
}
