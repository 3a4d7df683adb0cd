"""Arms whose joints do not stand where their readings say: uneven gears."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.support import machines

Array = np.ndarray

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")


@dataclass(frozen=True)
class Geared(machines.Arm):
    """An arm whose joints do not stand where its readings (N, k) say, but ``extra`` (N, k) farther on."""

    extra: Callable[[Array], Array]

    def tips(self, readings: Array) -> Array:
        return machines.Arm.tips(self, readings + self.extra(readings))


def geared(arm: machines.Arm, extra: Callable[[Array], Array]) -> Geared:
    return Geared(arm.joints, arm.ranges, extra)


def wavy(gains: Array, cosines: dict[int, Array], sines: dict[int, Array]) -> Callable[[Array], Array]:
    def extra(u: Array) -> Array:
        waves = [
            a * np.cos(k * u) + b * np.sin(k * u) for (k, a), b in zip(cosines.items(), sines.values(), strict=True)
        ]
        return np.asarray(gains * u + sum(waves))

    return extra
