"""What all pages are made of: tables, pictures, style and templates."""
