"""What experts are made of: skills, each planned from the state that it finds, and programs of them."""
