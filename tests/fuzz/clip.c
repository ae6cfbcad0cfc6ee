/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Random edits of clips for runtime/dynamorph.h, compiled with the sanitizers: clip SEED SECONDS FILE... The files as they
 * are first. The clip in work is in `now`; a crash leaves its bytes in the file crash.npz.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "dynamorph.h"

#define MOST (1 << 16)

void __sanitizer_set_death_callback(void (*)(void));

static unsigned char now[MOST];
static size_t now_size;

static void keep(void) {
  FILE* file = fopen("crash.npz", "wb");
  fwrite(now, 1, now_size, file);
  fclose(file);
}

static uint64_t state;

static size_t below(size_t n) {
  state ^= state << 13, state ^= state >> 7, state ^= state << 17;
  return n ? (size_t)(state >> 11) % n : 0;
}

static void edit(void) {
  static const unsigned char wild[] = {0, 1, 0x7f, 0x80, 0xff, '0', '9', '(', ')', ','};
  if (!now_size) return;
  const size_t at = below(now_size), count = below(8) + 1;
  switch (below(6)) {
    case 0: now_size = below(now_size); break;
    case 1: now[at] ^= (unsigned char)(1 << below(8)); break;
    case 2:
      for (size_t i = at; i < at + count && i < now_size; ++i) now[i] = wild[below(sizeof wild)];
      break;
    case 3: now[at] = (unsigned char)below(256); break;
    case 4: /* copied over another place, as a header into another array */
      for (size_t i = 0, from = below(now_size); i < 64 && at + i < now_size && from + i < now_size; ++i)
        now[at + i] = now[from + i];
      break;
    case 5: /* the end is moved */
      if (now_size - at > count) memmove(now + at, now + at + count, now_size - at - count), now_size -= count;
      break;
  }
}

/* All that the header reads of a clip, from a copy of just its size: the sanitizer sees every read beyond it. */
static void play(void) {
  static const double frames[] = {0, 0.5, -1, 3.5, 1e300, -1e300, NAN, INFINITY};
  unsigned char* bytes = malloc(now_size ? now_size : 1);
  memcpy(bytes, now, now_size);
  dm_clip clip;
  if (!dm_open(&clip, bytes, now_size)) {
    float* surface = malloc(sizeof *surface * (3 * (size_t)clip.vertices + 1));
    float* values = malloc(sizeof *values * ((size_t)clip.modes + (size_t)clip.targets + 1));
    for (size_t i = 0; surface && values && i < sizeof frames / sizeof *frames; ++i) {
      dm_surface(&clip, frames[i], surface);
      dm_values(&clip, frames[i], values, values + clip.modes);
    }
    free(surface);
    free(values);
  }
  free(bytes);
}

int main(int count, char** arguments) {
  if (count < 4) return 1;
  static unsigned char files[64][MOST];
  static size_t sizes[64];
  const int most = count - 3 < 64 ? count - 3 : 64;
  __sanitizer_set_death_callback(keep);
  for (int i = 0; i < most; ++i) {
    FILE* file = fopen(arguments[i + 3], "rb");
    if (!file) return 1;
    now_size = sizes[i] = fread(files[i], 1, MOST, file);
    fclose(file);
    memcpy(now, files[i], now_size);
    play();
  }
  state = strtoull(arguments[1], NULL, 10) + 1;
  const time_t ends = time(NULL) + atoi(arguments[2]);
  long clips = 0;
  do {
    for (int k = 0; k < 1000; ++k, ++clips) {
      const size_t i = below((size_t)most);
      memcpy(now, files[i], now_size = sizes[i]);
      for (size_t edits = below(6) + 1; edits; --edits) edit();
      play();
    }
  } while (time(NULL) < ends);
  printf("%ld clips\n", clips);
  return 0;
}
