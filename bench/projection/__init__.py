"""The accuracy of projections: docs/projection_accuracy.md."""
