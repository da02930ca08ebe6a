"""Where units go out: tables, pictures and documents of a result."""
