"""Words that a user chooses between; here, so that the command line can list them before anything else is loaded."""

from typing import Literal

# What instruments tell of the tool.
Observed = Literal["position", "pose"]
# What a plan is of: of pixels, beside photographs that a job has.
Planned = Literal["position", "pose", "pixels"]
# How designs of poses are judged.
Criterion = Literal["D", "A", "I"]
# What commands are to reach, and in whose frame that is said.
What = Literal["pose", "position"]
PoseFrame = Literal["base", "instrument"]
# Whose frame the base of a positioner was found in.
PlacedIn = Literal["arm", "instrument"]
# How a DH table is written.
Convention = Literal["standard", "modified"]
# What files controllers take.
Target = Literal["ur", "offsets", "dh", "ros", "xacro"]
# Of random poses: what a person waits for, and a memory holds.
MOST_POSES = 1_000_000
# Of candidates, of each of which some copies of all its derivatives are kept: a gigabyte for an arm of six joints.
MOST_CANDIDATES = 100_000
# Of poses that a plan chooses one after the other, each looked at beside all that are left.
MOST_CHOSEN = 1000
# Parts that rows are held out in, one after the other.
FOLDS = 10
