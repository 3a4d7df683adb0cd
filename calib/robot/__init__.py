"""Robot: URDF in and out, the chain with its deviations, kinematics by Pinocchio."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
