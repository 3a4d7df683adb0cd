"""Which poses to measure: :func:`calib.plan`, and the descriptions of the set-up that it takes."""

from calib.assessment.candidates import Candidates, PlannedMeasurement, Sight, possible, random_candidates, roughly
from calib.assessment.planning import Forecast, Plan, plan
from calib.assessment.telling import most_telling
from calib.assessment.views import Views, plan_views, view_candidates
from calib.robot.collision import SelfCollision, self_collision

__all__ = [
    "Candidates",
    "Forecast",
    "Plan",
    "PlannedMeasurement",
    "SelfCollision",
    "Sight",
    "Views",
    "most_telling",
    "plan",
    "plan_views",
    "possible",
    "random_candidates",
    "roughly",
    "self_collision",
    "view_candidates",
]
