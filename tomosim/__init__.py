"""The command ``tomosim``: the one place that knows the science, the service and its client."""
