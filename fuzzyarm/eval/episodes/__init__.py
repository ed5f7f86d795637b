"""What happened: one episode recorded, its file and its metrics."""
