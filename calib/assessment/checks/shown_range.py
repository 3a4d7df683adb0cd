"""For which range a calibration was shown to be right, and what would make the verdict more certain."""

from collections.abc import Sequence

import numpy as np

from calib.assessment.judged import JudgedSet
from calib.foundations.arrays import Array
from calib.foundations.units import DEG
from calib.identification.fit import Fit
from calib.measurement.poses import ONE_POSE


def shown_range(fit: Fit, own: Sequence[JudgedSet], held_out: Sequence[JudgedSet]) -> tuple[str, ...]:
    """Return for which range it was shown, and what would make it more certain."""
    judged = held_out or own
    data = [one.data for one in judged]
    said = []
    places = [fit.places_of(d) for d in data if d.position is not None and len(d)]
    whole = [fit.places_of(one.data) for one in own if one.data.position is not None]
    readings = np.concatenate([end.readings for d in data for end in d.ends])
    if places:
        box = np.ptp(np.concatenate(places), axis=0)
        said.append("Shown for the measured range: " + " x ".join(f"{side:.2g}" for side in box) + " m")
    else:
        said.append("Shown for the measured range")
    # A table of one arm of several says nothing of the joints of the others.
    moved = {
        reading.name: np.ptp(np.concatenate(told))
        for k, reading in enumerate(fit.robot.readings)
        if reading.dimension == "angle"
        if (told := [end.readings[:, k] for d in data if reading.name not in d.absent for end in d.ends])
    }
    few = [f"{name} over {by / DEG:.0f} deg" for name, by in moved.items() if by < 30.0 * DEG]
    if few:
        said[0] += f", and for {', '.join(few[:3])}{' and others' if len(few) > 3 else ''} only"
    said[0] += "."
    poses = len(np.unique(np.round(readings / ONE_POSE), axis=0))
    if not held_out:
        said.append("Held-out rows would show how well the machine predicts other poses.")
    elif poses < 20:
        said.append("More than 20 held-out poses would make the verdict more certain.")
    elif whole and places and _volume(places) < 0.1 * _volume(whole):
        said.append("Held-out rows in the whole measured volume would make the verdict more certain.")
    elif few:
        said.append("Rows with larger motions of these joints would widen the range.")
    elif all(noise.instrument == 0.0 for noise in fit.noise):
        said.append("A stated sigma of the instrument would separate its noise from what the model leaves out.")
    return tuple(said)


def _volume(places: Sequence[Array]) -> float:
    return float(np.prod(np.maximum(np.std(np.concatenate(places), axis=0), 1e-6)))
