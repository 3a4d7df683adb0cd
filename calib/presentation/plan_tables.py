"""Tables of a plan of measurements."""

from calib.assessment.planning import Plan
from calib.foundations.units import MM
from calib.presentation.report.document import Row, Sheet


def forecast_sheet(plan: Plan) -> Sheet:
    """Return what more and fewer poses would bring, chosen and at random, in mm."""
    rows = []
    for forecast in plan.forecasts:
        values = (f"{value / MM:.4f}" for value in (forecast.chosen, forecast.random))
        rows.append(Row((str(forecast.poses), *values), strong=len(plan.readings) == forecast.poses))
    return Sheet.of(
        "Error of the tool that more poses would remove, rms [mm]",
        (">poses", ">chosen", ">at random"),
        rows,
        f"over the working poses; not included is what no pose removes: {plan.floor / MM:.4f} mm",
    )


def index_sheet(plan: Plan) -> Sheet:
    """Return the observability indices of the chosen poses beside those of random ones."""
    rows = [
        (who, *(f"{value:.4g}" for value in found.values()))
        for who, found in (("chosen", plan.indices), ("at random", plan.random_indices))
    ]
    return Sheet.of("Observability (larger is better)", ("poses", *(f">{name}" for name in plan.indices)), rows)


def enough_sentence(planned: Plan, target: str, *, more: bool) -> str:
    """Return how many poses keep the error below a target, beside those measured already where there are ``more``."""
    if planned.enough is None:
        return f"No number of these candidates keeps the error below {target}."
    return f"{planned.enough}{' more' if more else ''} of the best poses keep the error below {target}."
