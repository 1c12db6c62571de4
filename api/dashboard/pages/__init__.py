"""The pages: each builds its elements and asks the facade; what is drawn comes from the pure modules."""
