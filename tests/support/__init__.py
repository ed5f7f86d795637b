"""What several test modules use: a browser, altered evaluations, small policy bundles, proven policies, processes."""
