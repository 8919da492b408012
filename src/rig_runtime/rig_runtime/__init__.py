"""What every node of the rig shares: parameters, topics, ticks, readiness, pacing, diagnostics and `run`."""
