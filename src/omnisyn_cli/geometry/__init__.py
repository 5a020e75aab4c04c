"""Closed-form geometry of the sphere; the convention statement lives in :mod:`omnisyn_cli.geometry.sphere`."""
