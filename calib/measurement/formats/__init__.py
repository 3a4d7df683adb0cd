"""Files of others that are no plain tables, as titles and cells of text; what these mean, ``calib init`` finds."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
