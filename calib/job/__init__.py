"""Job: a job file in, a folder of results out; no mathematics."""
