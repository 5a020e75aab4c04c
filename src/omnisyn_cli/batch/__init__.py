"""Many jobs on many workers, on one machine or on a Ray cluster, with a record that a second run continues from."""
