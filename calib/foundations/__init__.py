"""Foundations: errors, units, files, arrays and rigid motions. Imports nothing of the other rooms."""
