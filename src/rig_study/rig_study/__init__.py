"""Offline analysis of recorded trials: measures, figures and the report."""
