"""What is kept of a site, and where: rows, tables and statements of the database."""
