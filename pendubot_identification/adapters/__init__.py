"""All input and output: serial port, pseudo-terminal, bags, CSV, YAML."""
