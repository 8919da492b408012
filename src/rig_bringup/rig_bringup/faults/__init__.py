"""`./rig faults`: each fault of docs/safety.md, done to a live graph, with what must follow and how soon."""
