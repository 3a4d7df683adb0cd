"""What a verdict is made of: the judged tables, and one check."""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from calib.foundations.arrays import Array
from calib.measurement.measurements import Measurements

# The statistic, or the threshold, of a check that had nothing to judge.
NOTHING = float("nan")

Use = Literal["identification", "validation"]
# Checks that a user may answer for: that it is so, and right.
Accepted = Literal["lengths", "tool and base", "joints", "lens"]


class JudgedSet(NamedTuple):
    """One table and its residuals (N, 3 or 6), measured minus predicted, in m and rad, before and after."""

    use: Use
    file: str
    data: Measurements
    before: Array
    after: Array


@dataclass(frozen=True, slots=True)
class Check:
    """One condition of trust: a ``statistic`` against its ``threshold``, in ``sentence`` with its unit.

    ``statistic`` is nan where there was nothing to judge; the check has then passed. ``least``: whether the threshold
    is the least that is allowed, not the most.
    """

    name: str
    statistic: float
    threshold: float
    passed: bool
    sentence: str
    least: bool = False

    @classmethod
    def of(
        cls, name: str, statistic: float, threshold: float, passed: object, sentence: str, *, least: bool = False
    ) -> "Check":
        """Return a check of plain numbers, also where NumPy's are given."""
        return cls(name, float(statistic), float(threshold), bool(passed), sentence, least)

    @classmethod
    def judged(
        cls, name: str, statistic: float, threshold: float, said: str, otherwise: str, *, least: bool = False
    ) -> "Check":
        """Return a check of a statistic that a threshold bounds; where it does not, ``otherwise`` ends the sentence."""
        passed = statistic >= threshold if least else statistic <= threshold
        return cls.of(name, statistic, threshold, passed, f"{said}{'.' if passed else otherwise}", least=least)

    @classmethod
    def idle(cls, name: str, threshold: float, sentence: str, *, least: bool = False) -> "Check":
        """Return a check that had nothing to judge, and so has passed."""
        return cls.of(name, NOTHING, threshold, True, sentence, least=least)

    def answered(self) -> "Check":
        """Return the check as passed, since the user has answered for it."""
        return replace(self, passed=True, sentence=f"{self.sentence} The job accepts this.")
