"""Judges each user action by the mode insertion gradient and admits, rejects or replaces it."""
