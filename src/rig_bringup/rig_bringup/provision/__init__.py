"""Set a machine up: nothing but the standard library, since it runs before anything is installed."""
