"""/v1/phantoms: label volumes of one's own."""
