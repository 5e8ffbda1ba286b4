/* The tactile model of Palpate: what a hand feels, from joint positions and the pose of what it touches.
 *
 *   cargo build --release -p palpate_touch        makes target/release/libpalpate_touch.so
 *
 * Functions return 0 or a code; palpate_touch_last_error has the message of the calling thread's last error. Scenes and
 * batches are numbers that are never given twice. Functions may be called from any thread; those of one batch wait for each
 * other. Texts are UTF-8 and end with a zero. A pose is x y z qw qx qy qz in m, its quaternion of norm 1, scalar first.
 * Rows follow each other: row-major, as NumPy has them. docs/touch.md says what readings mean.
 */
#ifndef PALPATE_TOUCH_H
#define PALPATE_TOUCH_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define PALPATE_TOUCH_ABI_VERSION 1

enum {
    PALPATE_TOUCH_BAD_ARGUMENT = 1, /* null, not UTF-8, an unknown scene or batch */
    PALPATE_TOUCH_BAD_FILE = 2,     /* station, model or object: missing, or not as it should be */
    PALPATE_TOUCH_BAD_INPUT = 3,    /* numbers that cannot be felt: NaN, time that stands still */
    PALPATE_TOUCH_BUG = 4           /* a mistake in the library */
};

/* Version of this interface; compare it with the one above. */
uint32_t palpate_touch_abi_version(void);

/* Copies as much of the message as has room, without a zero, and returns its length in bytes. */
size_t palpate_touch_last_error(char *buffer, size_t capacity);

/* Opens a scene. model_text: text of a sensor model's file, or NULL for the station's nominal model; model_name: what errors
 * call it. object, fixed_objects: ids of objects of the station, or paths of object files; the fixed ones stand still at
 * fixed_poses (num_fixed x 7). */
int32_t palpate_touch_open(const char *station, const char *model_name, const char *model_text, const char *object,
                           size_t num_fixed, const char *const *fixed_objects, const double *fixed_poses, uint64_t *scene);

/* Copies what the scene is made of, as JSON, as much as has room, and puts its length in bytes into length. */
int32_t palpate_touch_describe(uint64_t scene, int32_t with_numbers, char *buffer, size_t capacity, size_t *length);

/* A whole take, as `palpate replay` computes it. times_s: num_frames; positions: num_frames x joints;
 * raw, active: num_frames x channels. */
int32_t palpate_touch_replay(uint64_t scene, size_t num_frames, const double *times_s, const double *positions,
                             const double *base_from_object, double *raw, uint8_t *active);

/* Opens a batch of environments of a scene, on num_threads (0: one for every core). */
int32_t palpate_touch_batch(uint64_t scene, size_t num_envs, size_t num_threads, uint64_t *batch);

/* One frame of every environment. times_s: environments; positions: environments x joints; poses: environments x 7;
 * raw, active: environments x channels. A step that is refused changes nothing. */
int32_t palpate_touch_step(uint64_t batch, const double *times_s, const double *positions, const double *poses, double *raw,
                           uint8_t *active);

/* A new episode begins where which (a byte for each environment) is not 0; NULL: everywhere. */
int32_t palpate_touch_restart(uint64_t batch, const uint8_t *which);

/* Closes a scene or a batch. Batches of a closed scene stay open. */
int32_t palpate_touch_close(uint64_t handle);

#ifdef __cplusplus
}
#endif

#endif
