/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Plays a raw Dynamorph clip (.npz): the soft surface at any time, before skinning. C99, nothing but the C library.
 *
 *   dm_clip clip;
 *   const char *error = dm_open(&clip, bytes, size);     bytes: the whole file, which must outlive the clip
 *   if (error) ...                                       a sentence; the clip is then empty
 *   float *surface = malloc(sizeof *surface * 3 * clip.vertices);
 *   dm_surface(&clip, seconds * clip.fps, surface);      between frames linear, beyond the ends constant
 *
 * surface = rest + sum_k z_k modes_k + sum_j w_j residual_shapes_j, the mesh object's local space: what the artist's
 * armature then deforms. An engine that blends morph targets itself needs only dm_values, and the rows of modes and
 * residual shapes. Little-endian machines only, as the file is. docs/file_format.md says what is in a clip.
 */
#ifndef DYNAMORPH_H
#define DYNAMORPH_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef struct {
  int frames, vertices, modes, targets;
  float fps;
  const float* rest;        /* (vertices, 3) */
  const float* mode;        /* (modes, vertices, 3) */
  const float* residual;    /* (targets, vertices, 3): what the modes cannot represent of each target's shape */
  const float* coordinates; /* (frames, modes) */
  const float* weights;     /* (frames, targets) */
} dm_clip;

/* One array of the archive. */
typedef struct {
  const float* data;
  int shape[3], axes;
} dm_array;

static uint32_t dm_read(const unsigned char* at, int bytes) {
  uint32_t value = 0;
  while (bytes--) value = value << 8 | at[bytes];
  return value;
}

/* The number after `text` in a header; moves `text` past it. -1 when there is none. */
static int dm_number(const char** text, const char* end) {
  int64_t value = -1;
  while (*text < end && (**text < '0' || **text > '9')) {
    if (**text == ')') return -1;
    ++*text;
  }
  for (; *text < end && **text >= '0' && **text <= '9'; ++*text) {
    value = (value < 0 ? 0 : value) * 10 + (**text - '0');
    if (value > INT32_MAX) return -1;
  }
  return (int)value;
}

/* The NumPy array in `size` bytes: float32, C order, one to three axes. */
static const char* dm_array_in(const unsigned char* bytes, size_t size, dm_array* out) {
  if (size < 12 || memcmp(bytes, "\x93NUMPY", 6)) return "the clip is damaged: an array has no header";
  const int wide = bytes[6] > 1 ? 4 : 2;
  const size_t length = dm_read(bytes + 8, wide);
  if (length > size - 8 - (size_t)wide) return "the clip is damaged: an array is cut off";
  const size_t begin = 8 + (size_t)wide + length;
  const char *text = (const char*)bytes + 8 + wide, *end = text + length;
  static const char kind[] = "{'descr': '<f4', 'fortran_order': False, 'shape': (";
  if (length < sizeof kind || memcmp(text, kind, sizeof kind - 1)) return "the clip has an array of another type";
  text += sizeof kind - 1;
  size_t count = 1;
  for (out->axes = 0; out->axes < 3; ++out->axes) {
    const int n = dm_number(&text, end);
    if (n < 0) break;
    if (n == 0) count = 0; /* whatever the other axes are */
    out->shape[out->axes] = n;
  }
  for (int axis = 0; axis < out->axes && count; ++axis) {
    if (count > size / (size_t)out->shape[axis]) return "the clip is damaged: an array has an impossible shape";
    count *= (size_t)out->shape[axis];
  }
  if (count != (size - begin) / sizeof(float) || (size - begin) % sizeof(float))
    return "the clip is damaged: an array does not fit its shape";
  if ((uintptr_t)(bytes + begin) % sizeof(float)) return "the file's bytes must be aligned to four";
  out->data = (const float*)(bytes + begin);
  return NULL;
}

/* The member `name` of the archive, which is stored without compression. */
static const char* dm_find(const unsigned char* bytes, size_t size, const char* name, dm_array* out) {
  static const char cut[] = "the clip is cut off";
  size_t end = size < 22 ? 0 : size - 22;
  if (size < 22) return cut;
  while (memcmp(bytes + end, "PK\5\6", 4)) /* the archive's last record, before a comment */
    if (end-- == 0) return cut;
  size_t at = dm_read(bytes + end + 16, 4);
  for (uint32_t left = dm_read(bytes + end + 10, 2); left; --left) {
    if (size < 46 || at > size - 46 || memcmp(bytes + at, "PK\1\2", 4)) return cut;
    const unsigned char* entry = bytes + at;
    const size_t length = dm_read(entry + 28, 2), stored = dm_read(entry + 24, 4), local = dm_read(entry + 42, 4);
    const size_t whole = 46 + length + dm_read(entry + 30, 2) + dm_read(entry + 32, 2);
    if (whole > size - at) return cut;
    at += whole;
    if (length != strlen(name) || memcmp(entry + 46, name, length)) continue;
    if (dm_read(entry + 10, 2) != 0) return "the clip is compressed: write it with Dynamorph, or numpy.savez";
    if (local > size - 30) return cut; /* size is at least 46 */
    const size_t begin = local + 30 + dm_read(bytes + local + 26, 2) + dm_read(bytes + local + 28, 2);
    if (begin > size || stored > size - begin) return cut;
    return dm_array_in(bytes + begin, stored, out);
  }
  return "this is not a Dynamorph clip: an array is missing";
}

/* The clip in the bytes of a .npz, none of which are copied: NULL, or why it cannot be played. */
static const char* dm_open(dm_clip* clip, const void* bytes, size_t size) {
  static const char* const names[] = {"vertices.npy",    "modes.npy",   "residual_shapes.npy",
                                      "coordinates.npy", "weights.npy", "fps.npy"};
  static const int axes[] = {2, 3, 3, 2, 2, 1};
  dm_array array[6];
  memset(clip, 0, sizeof *clip);
  for (int i = 0; i < 6; ++i) {
    const char* error = dm_find((const unsigned char*)bytes, size, names[i], &array[i]);
    if (error) return error;
    if (array[i].axes != axes[i]) return "the clip is damaged: an array has the wrong number of axes";
  }
  const int vertices = array[0].shape[0], modes = array[1].shape[0], targets = array[2].shape[0];
  const int frames = array[3].shape[0];
  if (array[0].shape[1] != 3 || array[1].shape[2] != 3 || array[2].shape[2] != 3 || array[1].shape[1] != vertices ||
      array[2].shape[1] != vertices || array[3].shape[1] != modes || array[4].shape[1] != targets ||
      array[4].shape[0] != frames || array[5].shape[0] != 1 || frames < 1)
    return "the clip is damaged: its arrays do not fit each other";
  clip->frames = frames;
  clip->vertices = vertices;
  clip->modes = modes;
  clip->targets = targets;
  clip->rest = array[0].data;
  clip->mode = array[1].data;
  clip->residual = array[2].data;
  clip->coordinates = array[3].data;
  clip->weights = array[4].data;
  clip->fps = array[5].data[0];
  return NULL;
}

/* Column `column` of `rows` (frames, columns) at a frame counted from 0. */
static float dm_value(const dm_clip* clip, const float* rows, int columns, int column, double frame) {
  const double last = clip->frames - 1, at = frame > 0 ? (frame < last ? frame : last) : 0;
  const size_t before = (size_t)at, after = before + (at < last);
  const float fraction = (float)(at - (double)before);
  return (1 - fraction) * rows[before * (size_t)columns + column] + fraction * rows[after * (size_t)columns + column];
}

/* Values of the modes (modes) and of the targets (targets) at a frame counted from 0. */
static void dm_values(const dm_clip* clip, double frame, float* coordinates, float* weights) {
  for (int k = 0; k < clip->modes; ++k) coordinates[k] = dm_value(clip, clip->coordinates, clip->modes, k, frame);
  for (int j = 0; j < clip->targets; ++j) weights[j] = dm_value(clip, clip->weights, clip->targets, j, frame);
}

/* surface += value * shape, of n numbers. */
static void dm_add(float* surface, const float* shape, float value, size_t n) {
  for (size_t i = 0; value != 0 && i < n; ++i) surface[i] += value * shape[i];
}

/* The surface (vertices, 3) at a frame counted from 0, local space. */
static void dm_surface(const dm_clip* clip, double frame, float* surface) {
  const size_t n = 3 * (size_t)clip->vertices;
  memcpy(surface, clip->rest, n * sizeof *surface);
  for (int k = 0; k < clip->modes; ++k)
    dm_add(surface, clip->mode + k * n, dm_value(clip, clip->coordinates, clip->modes, k, frame), n);
  for (int j = 0; j < clip->targets; ++j)
    dm_add(surface, clip->residual + j * n, dm_value(clip, clip->weights, clip->targets, j, frame), n);
}

#endif
