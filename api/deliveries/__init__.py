"""/v1/deliveries: cases on their way to a destination."""
