"""Control laws that are not learned, as policies."""
