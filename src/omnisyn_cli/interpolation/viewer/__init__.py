"""A walk: panoramas and their surfaces in a page that a browser draws, see ``docs/view.md``."""
