"""Settings: strict models, layers of tables, TOML; of no subject in particular."""
