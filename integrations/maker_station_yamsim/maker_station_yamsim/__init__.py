"""The programs of the maker's yam-abc-reproduce on yamsim's simulated station."""
