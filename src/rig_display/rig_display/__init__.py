"""A person at the rig: a browser page shows the task live, and the hand on it is the force sensor."""
