"""The proving ground: manoeuvres, identification, acceptance tests of a car."""
