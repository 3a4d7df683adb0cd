"""Assessment: how good is a calibration, and may it be trusted."""
