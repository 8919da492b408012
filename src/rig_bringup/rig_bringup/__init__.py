"""Bring-up: the command line behind `./rig`, scenarios, starting and stopping the graph."""
