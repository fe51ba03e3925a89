"""The only modules that know Ray (``pool``) and MLflow (``tracking``, ``likelihood_pyfunc``)."""
