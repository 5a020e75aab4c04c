"""What a job will take before it runs: memory, seconds, and the preset that fits into a budget of seconds."""
