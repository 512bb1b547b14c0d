"""/v1/webhooks: who is told of what happens."""
