"""Simulated user: answers each state of the task with a force at the sensor."""
