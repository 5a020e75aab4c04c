"""While tests run, the shapes in the signatures of ``omnisyn_cli.geometry`` are checked at every call."""

from jaxtyping import install_import_hook

install_import_hook("omnisyn_cli.geometry", "typechecker.check").__enter__()
