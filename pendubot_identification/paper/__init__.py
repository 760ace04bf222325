"""All that only the reproduction of the paper needs: its functions, competitors, trials, tables, figures, command."""
