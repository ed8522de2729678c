/* A car or a controller as a WebAssembly module with one instance. It follows the C source that defines fmu_t. */

#define EXPORT(name) __attribute__((export_name(#name)))

static fmu_t fmu;

EXPORT(reset) void module_reset(void) { reset(&fmu); }
EXPORT(begin) void module_begin(void) { begin(&fmu); }
EXPORT(step) int module_step(int n) { return advance(&fmu, n) != NULL; }
EXPORT(inputs) double *module_inputs(void) { return fmu.FMU_INPUTS; }
EXPORT(outputs) double *module_outputs(void) { return fmu.FMU_OUTPUTS; }
EXPORT(parameters) double *module_parameters(void) { return fmu.FMU_PARAMETERS; }
EXPORT(cells) double *module_cells(void) { return CELLS; }  /* the route, which the page fills before the start */
#ifdef GEARS  /* a controller: differential torques of a user's law, front and rear (N m) */
EXPORT(held) double *module_held(void) { return fmu.held; }
#endif
