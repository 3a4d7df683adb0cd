"""A fit as tables and sentences, on the terminal and in plain text."""

from rich.console import Group
from rich.text import Text

from calib.assessment.metrics import metrics
from calib.foundations.arguments import checked
from calib.foundations.words import printable
from calib.identification.fit import Fit
from calib.presentation import sheets
from calib.presentation.report.document import Sheet
from calib.presentation.tables import plain, sheet_table


@checked
def table(fit: Fit) -> str:
    """Return the fit as plain text: errors before and after on its own data, its parameters and its doubts."""
    return plain(Group(*map(sheet_table, fit_sheets(fit)), *map(Text, map(printable, fit_sentences(fit)))))


def fit_sheets(fit: Fit) -> tuple[Sheet, Sheet]:
    """Return the errors of a fit before and after, on its own data, and its parameters."""
    figures = {
        "identification": {
            when: metrics((data.kind, r) for data, r in zip(fit.measurements, residuals, strict=True))
            for when, residuals in (("before", fit.nominal_residuals), ("after", fit.residuals))
        }
    }
    return sheets.error_sheet(figures), sheets.parameter_sheet(fit)


def fit_sentences(fit: Fit) -> tuple[str, ...]:
    """Return the noise of a fit, its learned priors and what the data determine, in sentences."""
    return (*sheets.noise_sentences(fit), *sheets.prior_sentences(fit), *sheets.rank_sentences(fit))
