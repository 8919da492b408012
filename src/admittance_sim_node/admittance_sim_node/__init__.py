"""Simulated admittance-controlled robot: turns the admitted force into motion."""
