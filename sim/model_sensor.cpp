#include "sim/model_sensor.h"

namespace celadon::sim {
namespace {

constexpr std::int64_t kLatest_ns = 5'000'000;  // after its time stamp: later, the driver's stamp would be wrong

}  // namespace

ModelSensor::ModelSensor(DeviceModel& model, FrameStore& store, std::uint64_t client)
    : model_(model), store_(store), client_(client) {}

bool ModelSensor::start() {
  under_way_.reset();
  shown_.reset();
  return !model_.camera_unplugged() && store_.start(client_);
}

void ModelSensor::stop() {
  store_.stop(client_);
  under_way_.reset();
  shown_.reset();
}

bool ModelSensor::begin_picture() {
  const std::int64_t now_ns = model_.now_ns();
  while (const FrameTicket* frame = model_.camera().oldest()) {
    if (frame->stamp_ns > now_ns) return false;
    if (now_ns - frame->stamp_ns <= kLatest_ns) {
      under_way_ = frame->number;
      return true;
    }
    // Its slot is in the renderer's hands until the picture is done.
    const auto late = model_.camera().take_read_out();
    if (!late) return false;
    model_.camera().give_back(late->slot);
  }
  return false;
}

CameraSensor::Picture ModelSensor::picture() {
  if (!under_way_) return {};
  if (!shown_) shown_ = model_.camera().take_read_out();
  if (!shown_ || shown_->number != *under_way_) return {};
  const auto bytes = store_.slot(shown_->slot).first(shown_->bytes_used);
  if (model_.config().camera.format == PixelFormat::grey8) return {bytes, shown_->corrupt};
  luma_.resize(bytes.size() / 2);
  chroma_.resize(luma_.size());
  for (std::size_t i = 0; i < luma_.size(); ++i) {
    luma_[i] = bytes[2 * i];
    chroma_[i] = bytes[2 * i + 1];
  }
  return {luma_, shown_->corrupt, chroma_};
}

void ModelSensor::end_picture() {
  if (shown_) model_.camera().give_back(shown_->slot);
  shown_.reset();
  under_way_.reset();
}

void ModelSensor::set_exposure(std::int64_t exposure_ns) {
  model_.camera().set_exposure(exposure_ns, model_.now_ns());
}

}  // namespace celadon::sim
