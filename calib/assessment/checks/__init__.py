"""The checks of a verdict, one pure function each.

Thresholds stand beside what uses them. They were set by sound sessions (docs/verdicts.md).
"""
