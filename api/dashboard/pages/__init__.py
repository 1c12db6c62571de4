"""The pages: each builds its elements and reads `Feed` or `Watch`; what is drawn comes from the pure modules."""
