"""The plates and what touches them: active set, friction, edges, bending."""
