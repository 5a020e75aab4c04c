"""Where panoramas were taken: pose files, formats of other programs, and poses found in or checked against pictures."""
