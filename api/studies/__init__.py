"""/v1/studies: families of cases."""

from api.studies.results import router as results_router
from api.studies.routes import router

router.include_router(results_router)

__all__ = ["router"]
