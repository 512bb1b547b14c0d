"""What the service and its clients agree on: names, what is posted, the models of answers.

Below the service and its clients, above the specification alone (docs/architecture.md): needs no server, no database
and no numerics. Its name is long so that no folder of a user has it too.
"""
