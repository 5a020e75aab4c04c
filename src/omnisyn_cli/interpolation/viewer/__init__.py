"""A walk: panoramas and their surfaces in a page that a browser draws, see ``docs/view.md``."""

from omnisyn_cli.interpolation.viewer.run import ViewJob, ViewPlan, plan_view, run_view
from omnisyn_cli.interpolation.viewer.serve import served

__all__ = ["ViewJob", "ViewPlan", "plan_view", "run_view", "served"]
