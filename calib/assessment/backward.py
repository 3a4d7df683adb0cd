"""Which joint is read the other way: its sign turned, a fit leaves less.

Of a joint that turned little, a tool behind its axis does nearly what a wrong sign does, and a fit takes it. What is
left is what the sign does beyond that, and a score test tells it as a gain below -1: the joint moves against its
reading. A fit anew says whether that is so.
"""

from collections.abc import Mapping

import numpy as np

from calib.assessment.effects import Effect
from calib.foundations.errors import CalibError
from calib.identification.fit import Fit
from calib.identification.identify import identify_alike
from calib.identification.sanity import otherwise_read

# Standard errors of a gain below -1, from which a sign is tried: few sound sessions have one.
_TRIED = 2.0
# By so much, in chi-squared, less must be left: of two machines of as many parameters one is then 150 times as likely.
# And by such a share: what gears leave of many rows, which no machine explains, hardly follows a sign.
_SURELY, _SHARE = 10.0, 0.1


def backward(gains: Mapping[str, Effect], fit: Fit) -> str:
    """Return the joint whose sign, turned, leaves clearly less of the rows, given by which share each moves more.

    Empty where there is none. The likeliest is tried alone; of streams none is.
    """
    likely = {name: one for name, one in gains.items() if one.value < -1.0 and abs(one.t) > _TRIED}
    if not likely or any(data.stream is not None for data in fit.measurements):
        return ""
    name = max(likely, key=lambda name: likely[name].size)
    turn = otherwise_read(np.array([-1.0 if one.name == name else 1.0 for one in fit.model.robot.readings]))
    try:
        # A sign that is right now leads there at once; for rows that no machine explains, starts elsewhere take long.
        turned = identify_alike(fit, [turn(data) for data in fit.measurements], ["*"], placed="begun")
    except CalibError:  # such as of an arm that cannot take these poses
        return ""
    pairs = zip(fit.noise, turned.noise, strict=True)
    gained = [then.degrees_of_freedom * (then.total**2 / now.total**2 - 1.0) for then, now in pairs if now.total > 0.0]
    freedom = sum(noise.degrees_of_freedom for noise in fit.noise)
    return name if sum(gained) > max(_SURELY, _SHARE * freedom) else ""
