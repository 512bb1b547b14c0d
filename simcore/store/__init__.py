"""The content-addressed store of stage results, and the places where it may lie: a folder, or a bucket with a cache."""
