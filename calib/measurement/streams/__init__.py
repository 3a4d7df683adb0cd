"""Streams: what an instrument measured while the arm moved, by its own clock, and readings by the controller's."""
