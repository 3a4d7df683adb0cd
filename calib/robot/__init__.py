"""Robot: URDF in and out, the chain with its deviations, kinematics by Pinocchio."""
