"""The errors a user can cause.

Every message is one clear sentence: what is wrong, where (file and line, joint, row), the value, what is allowed.
The command line prints it and exits with 1; anything else that escapes is a bug and shows its traceback.
"""


class CalibError(Exception):
    """Base of every error that a user's input can cause."""


class RobotError(CalibError, ValueError):
    """The robot description cannot be used."""


class MeasurementError(CalibError, ValueError):
    """The measurements cannot be used."""


class JobError(CalibError, ValueError):
    """The job, or an option given to the library, cannot be used."""


class IdentificationError(CalibError, ValueError):
    """The parameters cannot be identified from these measurements."""


class OutputError(CalibError, OSError):
    """The results cannot be written or read back."""
