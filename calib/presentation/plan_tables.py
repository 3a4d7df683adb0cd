"""Tables of a plan of measurements."""

from rich import box
from rich.table import Table
from rich.text import Text

from calib.assessment.planning import Plan
from calib.foundations.units import MM


def forecast_table(plan: Plan) -> Table:
    """Return what more and fewer poses would bring, chosen and at random, in mm."""
    out = Table(
        title="Error of the tool that more poses would remove, rms [mm]",
        caption=f"over the working poses; not included is what the model leaves out: {plan.floor / MM:.4f} mm",
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    for name in ("poses", "chosen", "at random"):
        out.add_column(name, justify="right")
    for forecast in plan.forecasts:
        chosen = len(plan.readings) == forecast.poses
        values = (f"{value / MM:.4f}" for value in (forecast.chosen, forecast.random))
        out.add_row(str(forecast.poses), *values, style="bold" if chosen else None)
    return out


def index_table(plan: Plan) -> Table:
    """Return the observability indices of the chosen poses beside those of random ones."""
    out = Table(title="Observability (larger is better)", title_justify="left", box=box.SIMPLE_HEAD)
    out.add_column("poses")
    for name in plan.indices:
        out.add_column(name, justify="right")
    for who, found in (("chosen", plan.indices), ("at random", plan.random_indices)):
        out.add_row(who, *(f"{value:.4g}" for value in found.values()))
    return out


def enough_sentence(planned: Plan, target: str, *, more: bool) -> Text:
    """Return how many poses keep the error below a target, beside those measured already where there are ``more``."""
    if planned.enough is None:
        return Text(f"No number of these candidates keeps the error below {target}.")
    return Text(f"{planned.enough}{' more' if more else ''} of the best poses keep the error below {target}.")
