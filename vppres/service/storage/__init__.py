"""Storage of a site: rows, tables and statements of the database."""
