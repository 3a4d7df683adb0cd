"""The calibrated machine: its prediction, its uncertainty, its files. What judges or uses it takes it whole."""
