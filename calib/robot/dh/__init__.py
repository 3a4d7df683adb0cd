"""Denavit-Hartenberg tables: another way to write the arm that a URDF describes, never a second kinematics."""
