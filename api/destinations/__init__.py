"""/v1/destinations: archives and workstations that cases can be sent to."""
