"""What minimises: modified differential evolution, and its competitors."""
