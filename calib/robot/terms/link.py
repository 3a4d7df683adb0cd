"""What terms of links have in common: a link gives way in coordinates of its own, which no reading moves."""

from collections.abc import Mapping
from typing import ClassVar

from calib.foundations.errors import JobError
from calib.foundations.selection import listed_names, select
from calib.robot.conditions import Conditions
from calib.robot.terms.kind import Coefficient, Dimension, Kind, Parts
from calib.robot.terms.term import WHOLE_ARM, JointTerm


class LinkKind(Kind):
    """A kind of terms of the link before a joint; with the word "arm" also of all links by one coefficient."""

    of_link: ClassVar[bool] = True

    def coefficient(self, term: JointTerm, dimension: Dimension) -> Coefficient:
        """Return unit and typical size of the coefficient, whatever the joint behind the link does."""
        return self.coefficients["length"]

    def there(self, parts: Parts, term: JointTerm) -> bool:
        """Return whether a term is of a link with a length."""
        whole = term.reading == "" and WHOLE_ARM in self.words
        return self.well_formed(term) and (whole or term.reading in parts.links)

    def chosen(self, selection: object, parts: Parts, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return the chosen terms: "all" are of the links before joints that move."""
        if WHOLE_ARM in self.words and isinstance(selection, str) and selection == WHOLE_ARM:
            return self.terms(parts, "", options)
        return super().chosen(selection, parts, options)

    def select(self, selection: object, parts: Parts) -> list[str]:
        """Return the joints that the chosen links end in."""
        if isinstance(selection, str):
            return select(selection, [name for name, moves in parts.links.items() if moves], self.key, *self.words)
        names = listed_names(selection, self.key, *self.words)
        if short := next((name for name in names if name in parts.joints and name not in parts.links), None):
            raise JobError(
                f"{self.key}: there is no link before {short!r}: it is at the same place as the joint before it."
            )
        return select(names, list(parts.links), self.key, *self.words)

    def offered(
        self, parts: Parts, told: Conditions, options: Mapping[str, object]
    ) -> tuple[tuple[JointTerm, ...], ...]:
        """Return one term for every link before a joint that moves, or for all of them where the kind has such."""
        if not (self.chosen_by_data and self.shows(parts, told, 0)):
            return ()
        names = [""] if WHOLE_ARM in self.words else [name for name, moves in parts.links.items() if moves]
        return tuple(self.terms(parts, name, options) for name in names)
