"""Results in, tables out; nothing here decides anything."""
