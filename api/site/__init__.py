"""What is no resource: the page, presets and schemas, the reference, health, metrics."""
