#pragma once
// toml++ with the same settings in every source: with different ones its inline functions collide when linked.
#define TOML_EXCEPTIONS 0
#define TOML_HEADER_ONLY 1
#include <toml++/toml.h>
