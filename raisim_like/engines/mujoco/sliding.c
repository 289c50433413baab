/* The correction of sliding contacts (contacts.py, docs/physics.md) as a control callback of MuJoCo.
 *
 * MuJoCo calls it in every step, after the velocities and before the solver, without the interpreter's lock. It changes
 * only models that carry the mark. The arithmetic is that of contacts.py, in the same order: the results are the same
 * to the bit. MuJoCo's headers give the layout of its structures, so the module holds for one version of MuJoCo.
 */
#define Py_LIMITED_API 0x030A0000
#include <Python.h>

#include <math.h>
#include <string.h>

#include <mujoco/mujoco.h>

static const char MARK[] = "sliding contacts stay closed";

static void keep_closed(const mjModel* m, mjData* d) {
  if (m->nnumeric != 1 || strcmp(m->names + m->name_numericadr[0], MARK)) {
    return;
  }
  for (int i = 0; i < d->ncon; i++) {
    const mjContact* contact = d->contact + i;
    const int row = contact->efc_address;
    /* Points on the edge of the margin have no force, and no row. */
    if (row >= 0) {
      const mjtNum speed = hypot(d->efc_vel[row + 1], d->efc_vel[row + 2]);
      d->efc_aref[row] -= contact->friction[0] * speed / m->opt.timestep;
    }
  }
}

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_sliding", "The correction of sliding contacts as a callback of MuJoCo.", -1, NULL,
    NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__sliding(void) {
  PyObject* module = PyModule_Create(&definition);
  if (module == NULL) {
    return NULL;
  }
  PyObject* address = PyLong_FromVoidPtr((void*)keep_closed);
  if (address == NULL || PyModule_AddObject(module, "ADDRESS", address) < 0 ||
      PyModule_AddStringConstant(module, "MARK", MARK) < 0 ||
      PyModule_AddIntConstant(module, "MUJOCO_VERSION", mjVERSION_HEADER) < 0) {
    Py_DECREF(module);
    return NULL;
  }
  return module;
}
