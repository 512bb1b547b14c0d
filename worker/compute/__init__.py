"""Simulating: the Celery worker, its slots, and the compute process of each."""
