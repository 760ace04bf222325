"""The paper's own: its functions, its competitors, and what its reproduction runs."""
