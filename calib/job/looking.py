"""A look at inputs before anything is solved: what is wrong with them, and what their poses can see."""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from calib.assessment.advice import null_space_advice, told_briefly
from calib.assessment.checks.of_fit import too_few
from calib.foundations.words import counted
from calib.identification.observability import Observability, observability
from calib.job.inputs import Inputs, load
from calib.job.proposal import Proposal
from calib.job.read import parse_job

NO_FINDINGS = "Units, names, limits and rows: no findings."


class Looked(NamedTuple):
    """What a check says of inputs: findings, and what their poses can see. ``brief``: of ``advised``, what is shown."""

    findings: list[str]
    seen: Observability
    advised: list[str]
    brief: Sequence[str]

    @property
    def sentence(self) -> str:
        """How much of the parameters the poses determine."""
        condition = f" (condition number {self.seen.condition:.3g})" if self.seen.rank else ""
        return (
            f"{counted(self.seen.numbers, 'number determines', 'numbers determine')} "
            f"{counted(self.seen.rank, 'combination')} of {counted(len(self.seen.parameters), 'parameter')}{condition}."
        )

    def contents(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"findings": self.findings, **self.seen.contents(), "advice": self.advised}


def loaded(found: Proposal, path: Path, say: Callable[[str], None]) -> Inputs:
    """Return the inputs of the job that a proposal makes, which would be ``path``. Raises CalibError."""
    folder = path.absolute().parent
    return load(path, say, parse_job(tomllib.loads(found.job(folder)), str(path)))


def looked_at(inputs: Inputs, say: Callable[[str], None], *, every: bool = False) -> Looked:
    """Look at what is wrong with inputs; ``every``: and at all directions of the null space, one by one."""
    say("computing what the poses determine")
    seen = observability(inputs.model, inputs.identify)
    advised = [a.sentence for a in null_space_advice(inputs.model, inputs.identify, seen.undetermined)]
    brief = advised if every else told_briefly(inputs.model, inputs.identify, seen.undetermined, advised)
    findings = [finding.sentence for finding in inputs.findings]
    # Levels free some parameters each.
    scarce = "" if inputs.job.levels else too_few(seen, inputs.model, inputs.identify)
    return Looked([*findings, scarce] if scarce else findings, seen, advised, brief)
