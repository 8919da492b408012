"""Simulated dynamic task and pacemaker of the loop: owns the trial's clock."""
