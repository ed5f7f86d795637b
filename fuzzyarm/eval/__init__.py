"""Rollouts, metrics, tables and figures."""
