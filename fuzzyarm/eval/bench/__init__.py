"""Speed: environment steps per second beside peers."""
