"""A judged calibration, and the folder, report and scene that are made of it."""
