"""Initialisation: start values of base, tools and targets, in closed form, for the nominal robot."""
