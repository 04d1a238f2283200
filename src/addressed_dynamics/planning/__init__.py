"""Planning in a learned simulator: actions whose predicted future costs least, found by sampling."""

from addressed_dynamics.planning.cem import CEM
from addressed_dynamics.planning.judging import Cost
from addressed_dynamics.planning.mppi import MPPI
from addressed_dynamics.planning.planner import Plan, Planner

__all__ = ["CEM", "MPPI", "Cost", "Plan", "Planner"]
