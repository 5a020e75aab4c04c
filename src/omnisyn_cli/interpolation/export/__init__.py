"""A tour as a thing for other programs: a textured mesh, points, discs, or a data set with depth.

``docs/export.md`` states axes, units and origin of every format; each is read back in the tests by a reader of others.
"""

from omnisyn_cli.interpolation.export.plan import (
    FORMATS,
    ExportJob,
    ExportPlan,
    ExportSummary,
    default_ending,
    plan_export,
)
from omnisyn_cli.interpolation.export.run import run_export

__all__ = ["FORMATS", "ExportJob", "ExportPlan", "ExportSummary", "default_ending", "plan_export", "run_export"]
