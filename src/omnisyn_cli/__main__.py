"""``python -m omnisyn_cli`` is ``omnisyn``."""

from omnisyn_cli.cli import main

if __name__ == "__main__":
    main()
