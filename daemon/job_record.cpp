#include "daemon/job_record.h"

#include <nlohmann/json.hpp>

namespace celadon {

nlohmann::json job_json(const JobRecord& job) {
  nlohmann::json out{{"id", job.id},
                     {"requested_by", job.requested_by},
                     {"state", to_string(job.state)},
                     {"reason", job.reason},
                     {"created", job.created},
                     {"simulated", job.simulated},
                     {"folder", job.folder.string()},
                     {"files", job.files}};
  if (job.state == ScanState::failed) out["failure"] = to_string(job.failure);
  return out;
}

}  // namespace celadon
