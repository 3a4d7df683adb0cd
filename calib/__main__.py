"""``python -m calib``: the command ``calib``."""

from calib_start import main

main()
