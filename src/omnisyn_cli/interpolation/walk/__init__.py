"""A walk: panoramas and their surfaces in a page that a browser draws, see ``docs/view.md``."""

from omnisyn_cli.interpolation.walk.contents import WalkOptions
from omnisyn_cli.interpolation.walk.run import WalkJob, WalkPlan, WalkSummary, plan_walk, run_walk
from omnisyn_cli.interpolation.walk.serve import served

__all__ = ["WalkJob", "WalkOptions", "WalkPlan", "WalkSummary", "plan_walk", "run_walk", "served"]
