"""What the routes of every resource work with: who asks, bodies, errors, pages, streams, conditions."""
