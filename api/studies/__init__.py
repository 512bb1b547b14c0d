"""/v1/studies: families of cases."""
